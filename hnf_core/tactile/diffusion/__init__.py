"""The network D_φ: prediction of tactile maps (touch-sensor images and heights) from images, by a small U-Net.

Start with `predict.py`, which turns views into tactile maps and has the noise schedule; `conditioning.py` normalises
its input, `unet.py` is the network.
"""
