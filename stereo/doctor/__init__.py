"""Explanations of a recording that makes no sense: hypotheses, tried on a few frames, and a judgement."""
