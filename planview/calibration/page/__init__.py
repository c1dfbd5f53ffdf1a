"""Calibration in the browser: its state (session), marks over a picture (overlay), the page (page)."""
