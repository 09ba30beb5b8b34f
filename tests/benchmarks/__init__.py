"""Measurements, run by hand: ``python -m tests.benchmarks.price_kernel``."""
