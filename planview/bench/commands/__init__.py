"""``planview bench``: one module per command."""
