"""Image pairs: recordings, rectification, matching, depth, and rendered recordings."""
