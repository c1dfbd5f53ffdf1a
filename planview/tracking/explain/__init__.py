"""How well people at some places explain every pixel, and following them by it; for trackers to build on."""
