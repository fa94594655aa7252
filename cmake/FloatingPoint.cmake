# The state of a world must not depend on the machine, so every source is compiled with the same plain IEEE 754
# arithmetic: no contraction of a*b+c, division and square root correctly rounded, denormals kept. The engine passes
# this target on to all that link to it within the build, so no source can miss it.
add_library(fastcollide_floating_point INTERFACE)

foreach(flags IN ITEMS CMAKE_CXX_FLAGS CMAKE_CXX_FLAGS_RELEASE CMAKE_CUDA_FLAGS)
  if("${${flags}}" MATCHES "-ffast-math|-Ofast|-funsafe-math-optimizations|/fp:fast|-use_fast_math")
    message(FATAL_ERROR "${flags} asks for inexact arithmetic (${${flags}}): results would differ between devices. "
      "Remove the flag; FastCollide is built with IEEE 754 arithmetic only.")
  endif()
endforeach()

if(MSVC)
  set(host_flags /fp:strict)
else()
  set(host_flags -ffp-contract=off -fno-math-errno)  # nobody reads errno after a square root
endif()
list(JOIN host_flags "," host_flags_of_nvcc)

# What would be saved without all that, and with sums in float: for docs/performance.md, and for nothing else.
option(FASTCOLLIDE_FREE_ORDER "Measure what equal bits cost, by an engine whose results depend on the device" OFF)
if(FASTCOLLIDE_FREE_ORDER)
  message(WARNING "FASTCOLLIDE_FREE_ORDER: results of this build are neither equal nor checked.")
  target_compile_definitions(fastcollide_floating_point INTERFACE FASTCOLLIDE_FREE_ORDER)
  target_compile_options(fastcollide_floating_point INTERFACE
    "$<$<COMPILE_LANGUAGE:CUDA>:--fmad=true;--prec-div=false;--prec-sqrt=false>")
  return()
endif()

target_compile_options(fastcollide_floating_point INTERFACE
  $<$<COMPILE_LANGUAGE:CXX>:${host_flags}>
  "$<$<COMPILE_LANGUAGE:CUDA>:--fmad=false;--ftz=false;--prec-div=true;--prec-sqrt=true;-Xcompiler=${host_flags_of_nvcc}>")
