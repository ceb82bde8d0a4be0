"""Description of materials: from tactile maps to tokens (feature vectors), from names and shading to library materials.

Start with `token.py`, the layout of a token, and `library.py`. `encoder_registry.py` chooses the encoder E, `fuse.py`
combines its tokens with library ones, `contact_model.py` holds the mechanics.
"""
