"""The flow solver, a library of its own: NumPy, SciPy, numba, scikit-fem."""
