"""One file a session of Blender; its functions `check_*` run in order, each a test of its own on the host's side."""
