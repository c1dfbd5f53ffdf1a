"""One file per foreign calibration format."""
