"""Loads a URDF with a dynamics library: each inertia is possible, the total mass is the file's."""
import sys
import xml.etree.ElementTree as ElementTree

import mujoco

path = sys.argv[1]
masses = [float(mass.get("value")) for mass in ElementTree.parse(path).iter("mass")]
# The compiler refuses an inertia that no body can have.
model = mujoco.MjModel.from_xml_path(path)
total = float(model.body_mass.sum())
# A body without a mass would get one from its solids.
assert masses and abs(total - sum(masses)) < 1e-6, (total, sum(masses))
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
assert model.nv >= 8, f"{model.nv} joints move"
print(f"{path}: {len(masses)} bodies of {total:.3f} kg, {model.nv} joints move")
