/* what code without a C library asks of <math.h>: instructions of WebAssembly, and functions of the page */
#define NAN __builtin_nanf("")
#define INFINITY __builtin_inff()
#define isnan(v) __builtin_isnan(v)
#define isfinite(v) __builtin_isfinite(v)
#define fabsf __builtin_fabsf
#define sqrtf __builtin_sqrtf
#define floorf __builtin_floorf
#define rintf __builtin_rintf
#define fabs __builtin_fabs
#define sqrt __builtin_sqrt
#define floor __builtin_floor
#define ceil __builtin_ceil
#define rint __builtin_rint
#define FROM_PAGE(name) __attribute__((import_module("env"), import_name(#name)))
FROM_PAGE(sin) double sin(double);
FROM_PAGE(cos) double cos(double);
FROM_PAGE(tan) double tan(double);
FROM_PAGE(asin) double asin(double);
FROM_PAGE(acos) double acos(double);
FROM_PAGE(atan) double atan(double);
FROM_PAGE(sinh) double sinh(double);
FROM_PAGE(cosh) double cosh(double);
FROM_PAGE(tanh) double tanh(double);
FROM_PAGE(asinh) double asinh(double);
FROM_PAGE(acosh) double acosh(double);
FROM_PAGE(atanh) double atanh(double);
FROM_PAGE(exp) double exp(double);
FROM_PAGE(log) double log(double);
FROM_PAGE(atan2) double atan2(double, double);
FROM_PAGE(pow) double pow(double, double);
FROM_PAGE(fmin) double fmin(double, double);
FROM_PAGE(fmax) double fmax(double, double);
