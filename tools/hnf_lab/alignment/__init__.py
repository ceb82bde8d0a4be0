"""Align visual appearance and two touch sensors in one embedding space: two ResNet-50 encoders, trained contrastively.

`inputs.py` makes tuples of image and touch, `train.py` trains the encoders, `results.py` evaluates them by linear
probes and retrieval.
"""
