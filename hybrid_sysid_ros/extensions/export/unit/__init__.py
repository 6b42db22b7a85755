"""A whole loop as one C unit: kernels in compiled Python's subset are translated to C99."""
