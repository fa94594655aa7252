find_package(Threads REQUIRED)

# The engine as a static library: all of src/, with the CUDA sources or with the file that stands in for them.
#   CUDA <bool>        with the CUDA backend
#   OPTIONS <flags>... further compiler options
function(fastcollide_add_engine name)
  cmake_parse_arguments(PARSE_ARGV 1 engine "" "CUDA" "OPTIONS")

  # Every file below src/ belongs to the engine, so a list would only repeat the folder.
  file(GLOB_RECURSE sources CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/src/*.cpp)
  if(engine_CUDA)
    file(GLOB_RECURSE cuda_sources CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/src/*.cu)
    list(REMOVE_ITEM sources ${PROJECT_SOURCE_DIR}/src/no_cuda.cpp)
    list(APPEND sources ${cuda_sources})
  endif()

  add_library(${name} STATIC ${sources})
  add_library(${name}::${name} ALIAS ${name})
  set_target_properties(${name} PROPERTIES
    POSITION_INDEPENDENT_CODE ON
    CXX_VISIBILITY_PRESET hidden
    CUDA_VISIBILITY_PRESET hidden
    VISIBILITY_INLINES_HIDDEN ON)
  target_compile_features(${name} PUBLIC cxx_std_20)
  target_include_directories(${name}
    PUBLIC $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>
    PRIVATE ${PROJECT_SOURCE_DIR}/src ${PROJECT_BINARY_DIR}/generated)
  target_link_libraries(${name} PUBLIC Threads::Threads $<BUILD_INTERFACE:fastcollide_floating_point>)
  if(MSVC)
    target_compile_options(${name} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:/W4>)
  else()
    target_compile_options(${name} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:-Wall;-Wextra>)
  endif()
  target_compile_options(${name} PRIVATE ${engine_OPTIONS})
  if(NOT MSVC)
    # No operation has an effect but its result, so that both sides of a choice may be computed, many at a time.
    set_source_files_properties(${PROJECT_SOURCE_DIR}/src/cpu/contact_block.cpp PROPERTIES
      COMPILE_OPTIONS -fno-trapping-math)
  endif()

  if(engine_CUDA)
    target_compile_features(${name} PRIVATE cuda_std_20)
    target_link_libraries(${name} PRIVATE CUDA::cudart_static)
    list(LENGTH CMAKE_CUDA_ARCHITECTURES architecture_count)
    if(architecture_count GREATER 1)
      target_compile_options(${name} PRIVATE $<$<COMPILE_LANGUAGE:CUDA>:--threads=0>)
    endif()
  endif()
endfunction()
