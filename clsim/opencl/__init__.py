"""OpenCL devices and the programs that run on them."""
