// The functions of OpenCL C that kernels use, for runtimes that would read the declarations of all of them before every
// program: PoCL does, for ten times as long as it takes to compile a small kernel. Attributes are those that it gives.

#define BUILTIN __attribute__((overloadable, const))
size_t BUILTIN get_global_id(uint);
size_t BUILTIN get_global_size(uint);
size_t BUILTIN get_group_id(uint);
size_t BUILTIN get_local_id(uint);
int BUILTIN min(int, int);
float BUILTIN floor(float);
float BUILTIN fma(float, float, float);
float BUILTIN sqrt(float);
double BUILTIN sqrt(double);
double BUILTIN rint(double);
double BUILTIN exp(double);
double BUILTIN sin(double);
double BUILTIN cos(double);
double BUILTIN atan2(double, double);
double BUILTIN fabs(double);
double BUILTIN cbrt(double);
double BUILTIN fmin(double, double);
double BUILTIN fmax(double, double);
double4 BUILTIN fmax(double4, double4);
double4 BUILTIN convert_double4(long4);
long4 BUILTIN convert_long4(double4);
int __attribute__((overloadable)) atomic_inc(volatile __global int*);
uint __attribute__((overloadable)) atomic_add(volatile __global uint*, uint);
void __attribute__((overloadable, convergent)) barrier(cl_mem_fence_flags);
