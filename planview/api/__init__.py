"""What each command does, as a function of the same name and arguments."""
