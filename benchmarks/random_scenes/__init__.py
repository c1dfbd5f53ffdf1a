"""Random scenes: the challenge suite, views of one camera, two rigs; each from a seed."""
