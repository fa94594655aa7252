# fastcollide/_core: the extension module, its type stub and the mark that the package is typed.
find_package(Python 3.10 REQUIRED COMPONENTS Interpreter Development.Module ${SKBUILD_SABI_COMPONENT})
execute_process(
  COMMAND ${Python_EXECUTABLE} -m nanobind --cmake_dir
  OUTPUT_VARIABLE nanobind_ROOT OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
find_package(nanobind CONFIG REQUIRED)

file(GLOB binding_sources CONFIGURE_DEPENDS python/*.cpp)
nanobind_add_module(_core STABLE_ABI NB_STATIC ${binding_sources})
target_include_directories(_core PRIVATE src ${PROJECT_BINARY_DIR}/generated)
target_link_libraries(_core PRIVATE fastcollide)
install(TARGETS _core LIBRARY DESTINATION fastcollide COMPONENT python)

if(NOT CMAKE_CROSSCOMPILING)
  nanobind_add_stub(_core_stub
    MODULE _core
    PYTHON_PATH $<TARGET_FILE_DIR:_core>
    OUTPUT ${PROJECT_BINARY_DIR}/_core.pyi
    MARKER_FILE ${PROJECT_BINARY_DIR}/py.typed
    DEPENDS _core)
  install(FILES ${PROJECT_BINARY_DIR}/_core.pyi ${PROJECT_BINARY_DIR}/py.typed DESTINATION fastcollide COMPONENT python)
endif()
