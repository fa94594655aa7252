// Whether functions may be written for the vector units of x86 processors, and what they are written with.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__)
#define FC_HAS_X86_SIMD 1
#include <immintrin.h>
#else
#define FC_HAS_X86_SIMD 0
#endif
