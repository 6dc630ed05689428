"""The types every room shares: cameras, a reconstruction, posed views. NumPy only; knows no stage."""
