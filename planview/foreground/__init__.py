"""Foreground: per-pixel mixtures in colour and depth, exposure gain, ghosts, connected regions."""
