"""Cameras: intrinsics, poses, rigs, their file formats, and how to obtain them."""

from calib.libraries import prepare_kernel_cache, silence_libraries

prepare_kernel_cache()
silence_libraries()
