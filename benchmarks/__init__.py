"""Measurements behind ``python -m benchmarks``, one module per benchmark."""
