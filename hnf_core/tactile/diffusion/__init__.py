"""D_φ: prediction of tactile maps from images of a patch, by a small U-Net in numpy.

Start with `predict.py`, which turns views into tactile maps; `conditioning.py` normalises its input, `unet.py` is the
network, `schedule.py` the noise schedule.
"""
