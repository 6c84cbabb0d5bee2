"""What things cost, measured: python -m benchmarks NAME, or manywake bench NAME. One module a measurement."""
