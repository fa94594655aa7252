# Decides whether CUDA is built, with which compiler and for which cards. Sets fastcollide_with_cuda.
#
# nvcc is looked for in this order: CUDACXX, PATH, CUDA_HOME, the cuda-toolkit package of the Python that builds. All
# must be known before CMake looks at the language CUDA, so everything is set first and enabled at the end.
set(oldest_cuda 12.8)  # the first that writes code for compute capability 12.0

if(DEFINED ENV{FASTCOLLIDE_CUDA})
  set(wanted_cuda "$ENV{FASTCOLLIDE_CUDA}")
else()
  set(wanted_cuda AUTO)
endif()
set(FASTCOLLIDE_CUDA "${wanted_cuda}" CACHE STRING "Build for CUDA: AUTO (if there is an nvcc), ON or OFF")
set_property(CACHE FASTCOLLIDE_CUDA PROPERTY STRINGS AUTO ON OFF)

if(DEFINED ENV{FASTCOLLIDE_CUDA_ARCHITECTURES})
  set(wanted_architectures "$ENV{FASTCOLLIDE_CUDA_ARCHITECTURES}")
else()
  # Machine code for each generation of cards, and PTX that later ones translate when they load it.
  set(wanted_architectures 75-real 80-real 86-real 89-real 90-real 100-real 120-real 120-virtual)
endif()
set(FASTCOLLIDE_CUDA_ARCHITECTURES "${wanted_architectures}" CACHE STRING
  "Compute capabilities to build for, in the words of CMAKE_CUDA_ARCHITECTURES; separated by commas or semicolons")

# Sets `result` to the version of an nvcc, or to nothing when it does not run.
function(fastcollide_nvcc_version nvcc result)
  execute_process(COMMAND ${nvcc} --version OUTPUT_VARIABLE output ERROR_QUIET)
  string(REGEX MATCH "release ([0-9]+\\.[0-9]+)" matched "${output}")
  set(${result} "${CMAKE_MATCH_1}" PARENT_SCOPE)
endfunction()

# Sets `result` to the root of the toolkit among the packages of the Python that builds, or to nothing.
function(fastcollide_packaged_toolkit result)
  set(${result} "" PARENT_SCOPE)
  find_package(Python 3.10 QUIET COMPONENTS Interpreter)
  if(Python_Interpreter_FOUND)
    execute_process(
      COMMAND ${Python_EXECUTABLE} -c "import nvidia.cu13; print(list(nvidia.cu13.__path__)[0])"
      OUTPUT_VARIABLE root ERROR_QUIET OUTPUT_STRIP_TRAILING_WHITESPACE)
    file(TO_CMAKE_PATH "${root}" root)
    set(${result} "${root}" PARENT_SCOPE)
  endif()
endfunction()

# Sets `result` to the first nvcc that is new enough; `found` tells all that were seen.
function(fastcollide_find_nvcc result found)
  if(NOT "$ENV{CUDACXX}" STREQUAL "")
    find_program(nvcc_named "$ENV{CUDACXX}" NO_CACHE)
  endif()
  find_program(nvcc_on_path nvcc NO_CACHE NO_CMAKE_PATH NO_CMAKE_ENVIRONMENT_PATH NO_CMAKE_SYSTEM_PATH)
  find_program(nvcc_at_home nvcc NO_CACHE NO_DEFAULT_PATH HINTS ENV CUDA_HOME PATH_SUFFIXES bin)
  fastcollide_packaged_toolkit(packaged_toolkit)
  find_program(nvcc_in_package nvcc NO_CACHE NO_DEFAULT_PATH HINTS "${packaged_toolkit}/bin")

  set(seen "")
  foreach(nvcc IN ITEMS "${CMAKE_CUDA_COMPILER}" "${nvcc_named}" "${nvcc_on_path}" "${nvcc_at_home}" "${nvcc_in_package}")
    if(nvcc MATCHES "^$|-NOTFOUND$")
      continue()
    endif()
    fastcollide_nvcc_version(${nvcc} version)
    if(version VERSION_GREATER_EQUAL oldest_cuda)
      set(${result} "${nvcc}" PARENT_SCOPE)
      return()
    endif()
    list(APPEND seen "${nvcc} (version ${version}, ${oldest_cuda} or newer is needed)")
  endforeach()
  set(${result} "" PARENT_SCOPE)
  list(JOIN seen ", " seen)
  set(${found} "${seen}" PARENT_SCOPE)
endfunction()

set(fastcollide_with_cuda OFF)
if(FASTCOLLIDE_CUDA STREQUAL "AUTO" OR FASTCOLLIDE_CUDA)
  fastcollide_find_nvcc(nvcc unsuitable)
  if(nvcc)
    set(fastcollide_with_cuda ON)
  else()
    if(NOT unsuitable)
      set(unsuitable "none")
    endif()
    set(nvcc_missing "nvcc was looked for through CUDACXX, PATH, CUDA_HOME and the Python package cuda-toolkit; found: ${unsuitable}")
    if(NOT FASTCOLLIDE_CUDA STREQUAL "AUTO")
      message(FATAL_ERROR "FASTCOLLIDE_CUDA=${FASTCOLLIDE_CUDA}, but there is no CUDA compiler. ${nvcc_missing}")
    endif()
    message(STATUS "FastCollide without CUDA: ${nvcc_missing}")
  endif()
else()
  message(STATUS "FastCollide without CUDA: FASTCOLLIDE_CUDA=${FASTCOLLIDE_CUDA}")
endif()

if(fastcollide_with_cuda)
  set(CMAKE_CUDA_COMPILER "${nvcc}")
  if(NOT DEFINED ENV{CUDAHOSTCXX} AND NOT MSVC)
    set(CMAKE_CUDA_HOST_COMPILER "${CMAKE_CXX_COMPILER}")
  endif()
  string(REGEX REPLACE "[, ]+" ";" CMAKE_CUDA_ARCHITECTURES "${FASTCOLLIDE_CUDA_ARCHITECTURES}")

  # The toolkit of the package index keeps its libraries in lib/, where neither nvcc nor FindCUDAToolkit looks, and has
  # the shared runtime only under its versioned name. Nothing links to that one, but FindCUDAToolkit insists on it.
  cmake_path(GET nvcc PARENT_PATH toolkit)
  cmake_path(GET toolkit PARENT_PATH toolkit)
  if(EXISTS "${toolkit}/lib/libcudart_static.a" AND NOT EXISTS "${toolkit}/lib64")
    set(CUDAToolkit_ROOT "${toolkit}")
    string(APPEND CMAKE_CUDA_FLAGS_INIT " -L${toolkit}/lib")
    file(GLOB versioned_cudart "${toolkit}/lib/libcudart.so.*")
    set(CUDA_CUDART "${versioned_cudart}" CACHE FILEPATH "Shared CUDA runtime, not linked" FORCE)
  endif()

  enable_language(CUDA)
  find_package(CUDAToolkit REQUIRED)
  set(fastcollide_cuda_version "${CUDAToolkit_VERSION_MAJOR}.${CUDAToolkit_VERSION_MINOR}")
  list(JOIN CMAKE_CUDA_ARCHITECTURES " " fastcollide_cuda_architectures)
  message(STATUS "FastCollide with CUDA ${fastcollide_cuda_version} (${nvcc}) for ${fastcollide_cuda_architectures}")
endif()
