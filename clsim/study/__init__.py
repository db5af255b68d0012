"""Studies: one scene file rendered many times with other values of some of its fields."""

# Modules of a worker, which the process that workers are forked from loads once for all.
OF_WORKERS = (
    "clsim.study.member", "numcodecs.zstd", "scipy.fft", "scipy.linalg", "pyopencl.invoker",
)  # fmt: skip
