"""Calibration in the browser: what it knows (session), how it draws (overlay), the page (page)."""
