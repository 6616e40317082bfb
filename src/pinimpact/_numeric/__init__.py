"""Linear algebra and contact problems for kernels of all packages."""
