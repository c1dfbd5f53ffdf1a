"""The rerun recording of a run."""
