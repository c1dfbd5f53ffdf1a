"""The engine: configuration, set-up, the stages in order, feedback from tracker to foreground."""
