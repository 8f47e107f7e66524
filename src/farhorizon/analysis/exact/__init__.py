"""The half-infinite chain: its kernels, their convolution and their compression."""
