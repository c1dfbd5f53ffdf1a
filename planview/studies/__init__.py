"""Studies: recordings times configurations times seeds, tracked and scored on many processes or machines."""
