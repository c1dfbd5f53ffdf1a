"""Image pairs: recordings, rectification, matching, depth, floor."""
