/* The number type of the core: double, or float with -DDMRAC_FLOAT. */
#ifndef DMRAC_REAL_H
#define DMRAC_REAL_H

#ifdef DMRAC_FLOAT
typedef float real;
#else
typedef double real;
#endif

/* A constant of the type `real`; it is rounded once, by the compiler. */
#define REAL(x) ((real)(x))

#endif
