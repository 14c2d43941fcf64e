"""The fused engine in C++, with the contract of `engine`."""
