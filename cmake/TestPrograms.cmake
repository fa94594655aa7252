# print_hash computes a scene through the public C++ interface and prints its state hash.
add_executable(print_hash tests/determinism/print_hash.cpp)
target_link_libraries(print_hash PRIVATE fastcollide)
add_test(NAME print_hash COMMAND print_hash)

# The same program on an engine compiled for wider vector units, with fused multiply-add, must print the same hash.
set(simd_levels "")
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64" AND NOT MSVC)
  set(simd_levels x86-64-v3)
endif()
set(FASTCOLLIDE_SIMD_LEVELS "${simd_levels}" CACHE STRING "Values of -march whose results are compared with the default one's")
foreach(level IN LISTS FASTCOLLIDE_SIMD_LEVELS)
  fastcollide_add_engine(fastcollide_${level} CUDA OFF OPTIONS -march=${level})
  add_executable(print_hash_${level} tests/determinism/print_hash.cpp)
  target_compile_options(print_hash_${level} PRIVATE -march=${level})
  target_link_libraries(print_hash_${level} PRIVATE fastcollide_${level})
  add_test(NAME same_hash_${level} COMMAND ${CMAKE_COMMAND}
    -D "expected=$<TARGET_FILE:print_hash>" -D "tested=$<TARGET_FILE:print_hash_${level}>"
    -P ${PROJECT_SOURCE_DIR}/cmake/SameOutput.cmake)
  set_tests_properties(same_hash_${level} PROPERTIES SKIP_REGULAR_EXPRESSION "Illegal instruction")
endforeach()

# A project of someone else finds the installed package, compiles against its headers and runs.
if(NOT CMAKE_CROSSCOMPILING AND NOT CMAKE_CONFIGURATION_TYPES)
  add_test(NAME example_contacts COMMAND ${CMAKE_COMMAND}
    -D built=${PROJECT_BINARY_DIR} -D work=${PROJECT_BINARY_DIR}/example_contacts
    -D source=${PROJECT_SOURCE_DIR}/examples/contacts -D program=contacts -D compiler=${CMAKE_CXX_COMPILER}
    -P ${PROJECT_SOURCE_DIR}/cmake/BuildExample.cmake)
endif()
