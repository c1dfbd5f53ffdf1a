"""The commands, one module per theme; cli.py loads each only when it is called."""
