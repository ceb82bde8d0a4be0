"""Evaluate methods by spectral and perceptual metrics, with the bounds that the data themselves allow.

`run.py` runs the evaluation and writes the report; `scoring.py` holds the trials, references and metrics. `tactile_map`
evaluates predicted tactile maps.
"""
