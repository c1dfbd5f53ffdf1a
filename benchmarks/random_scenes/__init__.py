"""Random scenes: the challenge suite, views of one camera, conference rooms, two rigs; each from a seed."""
