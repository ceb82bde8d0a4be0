"""Train D_φ, the diffusion network that predicts a tactile map from images and depth.

Rendered pairs become augmented batches (`batches`), a torch network (`map_network`) learns to denoise slopes, and
`validation` measures it on held-out splits. Read `train_map` first. Inference is in hnf_core.tactile.diffusion.
"""
