"""Is this recording and its calibration to be trusted? One file per family of checks."""
