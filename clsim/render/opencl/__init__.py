"""The OpenCL engine."""
