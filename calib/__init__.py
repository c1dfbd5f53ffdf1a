"""Cameras: intrinsics, poses, rigs, their file formats, and how to obtain them."""
