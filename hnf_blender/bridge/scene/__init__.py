"""General access to scenes and objects: meshes, bounding boxes, names, attributes, temporary scenes.

Read `meshes.py` first: it defines the surface frame, in which strokes, patches (squares of surface) and cameras are
given.
"""
