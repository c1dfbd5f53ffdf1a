"""Random scenes: the challenge suite, conference rooms, two rigs; each from a seed."""
