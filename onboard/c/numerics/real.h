/* The number type of the core: double, or float with -DDMRAC_FLOAT. */
#ifndef DMRAC_REAL_H
#define DMRAC_REAL_H

#ifdef DMRAC_FLOAT
typedef float real;
#define REAL_BELOW_ONE 0.99999994f /* the largest number below 1 */
#else
typedef double real;
#define REAL_BELOW_ONE 0.99999999999999989
#endif

/* A constant of the type `real`; it is rounded once, by the compiler. */
#define REAL(x) ((real)(x))

#endif
