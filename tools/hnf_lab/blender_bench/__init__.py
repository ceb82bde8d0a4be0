"""Benches of what Blender is asked to wait for. No part of the extension."""
