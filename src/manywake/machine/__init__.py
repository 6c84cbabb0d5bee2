"""The ground floor: lanes of a vector register, compilation with its cache, files written whole."""
