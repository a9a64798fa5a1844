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
double sin(double), cos(double), tan(double), asin(double), acos(double), atan(double), atan2(double, double);
double sinh(double), cosh(double), tanh(double), asinh(double), acosh(double), atanh(double);
double exp(double), log(double), pow(double, double), fmin(double, double), fmax(double, double);
