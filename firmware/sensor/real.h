/* Numbers of the model: double precision; single precision with TF_SINGLE, for a processor without floating point. */
#ifndef TF_REAL_H
#define TF_REAL_H

#include <math.h>

/* REAL(sin) is the sine of this precision. */
#ifdef TF_SINGLE
typedef float real;
#define REAL(function) function##f
#else
typedef double real;
#define REAL(function) function
#endif

#endif
