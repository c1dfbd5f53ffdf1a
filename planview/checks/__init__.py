"""Sanity checks of recordings and calibrations, one file per family of checks."""
