"""Calibration from recordings: boards, floor, standing people, and the page in the browser."""
