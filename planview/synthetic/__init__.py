"""Rendered recordings with exact truth."""
