"""Boards: chessboard and ChArUco corners to a calibrated rig."""
