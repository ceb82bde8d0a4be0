"""The network D_φ: prediction of tactile maps (touch-sensor images and heights) from images, by a small U-Net.

Start with `predict.py`, which normalises views, turns them into tactile maps and has the noise schedule; `unet.py` is
the network.
"""
