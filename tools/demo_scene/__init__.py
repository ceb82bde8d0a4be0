"""Parts of the demo scene, built by code alone; tools/make_demo_scene.py puts them together."""
