"""One reader per recording layout."""
