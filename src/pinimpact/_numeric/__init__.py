"""What kernels of every package use: how they are compiled, and small dense linear algebra."""
