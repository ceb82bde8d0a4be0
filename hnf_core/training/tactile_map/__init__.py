"""Train D_φ, the diffusion network that predicts a tactile map from images and depth.

Rendered pairs of photograph and touch become augmented batches for a torch network that learns to denoise surface
slopes (`map_network`); `train_map` trains it and measures it on held-out data. Read `train_map` first. Inference is in
hnf_core.tactile.diffusion.
"""
