"""The vehicle and the floor as a MuJoCo model, in MJCF (MuJoCo's XML).

MuJoCo's z points up. World: x north, y west, z up. Body: x forward, y left, z up. So a vector of the project (NED or
FRD) has the signs of y and z changed, and so has the vector part of a quaternion.

A free body has the mass, centre of mass and inertia of the parameters. A site at each rotor carries an actuator, whose
force along the rotor's axis turns with the body; one more actuator is the torque of all rotors about body up. Four feet
and four rotor rims, small spheres, touch the floor; the contact is MuJoCo's own, with its usual stiffness.
"""

from typing import Final

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.dynamics import contact_point, rotor_place

CONTACT_RADIUS_M: Final = 1.0e-4
"""Of the spheres that touch the floor: nearly points, as in dynamics.py."""
CONTACT_POINTS: Final = 8
YAW_ACTUATOR: Final = 4
"""After the four of the rotors."""

_MODEL: Final = """
<mujoco model="vehicle">
  <compiler angle="radian"/>
  <option timestep="{step_s}" gravity="0 0 {down_m_s2}" integrator="RK4" cone="elliptic">
    <flag autoreset="disable"/>
  </option>
  <default>
    <geom condim="3" friction="{friction} 0 0"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="vehicle">
      <freejoint/>
      <inertial pos="{centre}" mass="{mass_kg}" fullinertia="{inertia}"/>
      <site name="centre"/>
{parts}
    </body>
  </worldbody>
  <actuator>
{actuators}
  </actuator>
</mujoco>
"""


def mjcf(P: Array) -> str:
    """The model of a vehicle with these parameters. P: [PARAMETERS_SIZE], see layout.py."""
    parts, actuators = [], []
    for i in range(4):
        x, y = rotor_place(i, P)
        place = _text(x, -y, P[at.ROTOR_HEIGHT])
        parts.append(f'      <site name="rotor{i + 1}" pos="{place}"/>')
        actuators.append(f'    <motor site="rotor{i + 1}" gear="0 0 1 0 0 0"/>')
    actuators.append('    <motor site="centre" gear="0 0 0 0 0 1"/>')
    for i in range(CONTACT_POINTS):
        x, y, z = contact_point(i, P)
        inwards = CONTACT_RADIUS_M if z > 0.0 else -CONTACT_RADIUS_M
        parts.append(f'      <geom size="{CONTACT_RADIUS_M}" pos="{_text(x, -y, inwards - z)}"/>')
    cx, cy, cz = P[at.CENTRE : at.CENTRE + 3]
    xx, yy, zz, xy, xz, yz = P[at.INERTIA : at.INERTIA + 6]
    return _MODEL.format(
        step_s=_text(P[at.STEP]),
        down_m_s2=_text(-P[at.GRAVITY]),
        friction=_text(P[at.FRICTION]),
        centre=_text(cx, -cy, -cz),
        mass_kg=_text(P[at.MASS]),
        inertia=_text(xx, yy, zz, -xy, -xz, yz),
        parts="\n".join(parts),
        actuators="\n".join(actuators),
    )


def _text(*values: float) -> str:
    """Numbers as MJCF has them, with all their digits."""
    return " ".join(repr(float(value)) for value in values)
