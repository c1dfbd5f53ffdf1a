"""Ellipses fitted to foreground (del-Blanco et al. 2012, section 2)."""
