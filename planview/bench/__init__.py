"""Measurements behind ``planview bench``, one module per subject."""
