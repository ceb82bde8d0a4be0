"""Touch a scene that Blender opens or imports: one WAV and one picture for every stroke. Needs bpy.

python examples/touch_scene.py SCENE FOLDER
"""

import sys

import hnf_core as hnf

scene, folder = sys.argv[1:3]
report = hnf.touch(scene, out=folder, seed=0)
for stroke in report["strokes"]:
    print(f"{stroke['name']} on {stroke['object']}: {stroke['library_material']}, {stroke['rms_m_s2']:.3g} m/s² RMS")
