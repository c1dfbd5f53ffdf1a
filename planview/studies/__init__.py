"""Studies: recordings times configurations times seeds, tracked on many processes or machines, scored and ranked."""
