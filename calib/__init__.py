"""Cameras: intrinsics, poses, rigs, their file formats, and how to obtain them."""

from calib.libraries import silence_libraries

silence_libraries()
