"""A contact law as a pad for MuJoCo: a bed of pins, each of which slides on a spring.

V = k_n F_n for a body of any shape is an elastic foundation: every point of the gel gives way on
its own, by the depth of the body there, with a pressure of 1/k_n for each mm of it. Pins a pitch a
apart, on springs of a²/k_n, are that foundation.

A single geom cannot have this law, whatever its ``solref`` and ``solimp``: MuJoCo's force is a
function of the depth of a contact and of the masses behind it. Fitted to a ball, it is off by a
factor of two for one of twice the radius, or if the body has another mass.
"""

import math
from dataclasses import dataclass
from pathlib import Path

from tacgen.contact.gel import gel_size_mm
from tacgen.contact.law import ContactLaw, load_law
from tacgen.contact.raster import dome_mm
from tacgen.core.errors import ContactError
from tacgen.core.files import atomic_folder, write_text
from tacgen.core.records import Sensor
from tacgen.core.types import M_PER_MM

PAD = "pad"
"""Name of the pad's body."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PinRules:
    """How a bed of pins is laid out."""

    pitch_mm: float = 0.5  # V of a ball whose contact is three pins wide is within 2 % of k_n F
    tip_mm: float = 0.02  # radius of a tip, by which a pin feels a body's radius too large
    max_time_step_s: float = 2e-3  # MuJoCo's default. A contact's time constant is two steps or
    # more, and its depth goes with the square: with ``mass_s2`` and ``impedance`` it adds 0.8 % to
    # a pin's, at half the step 0.2 %
    contact_s: float = 2e-3  # time constant of contacts; MuJoCo raises it to two steps
    mass_s2: float = 2e-7  # mass of a pin over its spring's stiffness, from which MuJoCo derives
    # how soft a contact is
    impedance: float = 0.9999  # the hardest contact that it allows
    pin_rad_per_s: float = 300.0  # of a pin's own oscillation, by an inertia along the pin alone:
    # slow enough for an explicit spring, and
    damping_ratio: float = 0.3  # for contacts that know nothing of it (steps of 4 ms still hold)


PINS = PinRules()


@dataclass(frozen=True, slots=True)
class PinPad:
    """What was written: pins, of a spring each, over a gel, and what of the law is not in it."""

    pins: int
    pitch_mm: float
    gel_size_mm: tuple[float, float]
    pin_stiffness_n_per_mm: float
    k_n_mm3_per_n: float
    max_time_step_s: float
    left_out: tuple[str, ...]

    def line(self) -> str:
        """One line for the terminal."""
        width, height = self.gel_size_mm
        return (
            f"{self.pins} pins, {self.pitch_mm:g} mm apart, on {width:.3g} × {height:.3g} mm of "
            f"gel: V = k_n F with k_n = {self.k_n_mm3_per_n:g} mm³/N, at time steps of up to "
            f"{1e3 * self.max_time_step_s:g} ms"
        )


def export_mujoco(law: ContactLaw | Path, sensor: Sensor, out: Path) -> PinPad:
    """Write ``pad.xml``: a body ``pad`` in the gel frame of ``sensor``, in metres.

    It covers the whole gel, dome included; a pin moves by up to the gel's thickness. The volume
    that a simulation displaces is a² times the sum of its joints' −q. Pins have the friction of
    what they touch (MuJoCo takes the larger), and do not give way sideways. A pin that an edge
    comes upon faster than some 10 mm/s may be caught beside it, and then pushes sideways. Friction
    is for MuJoCo's default cone, pyramidal with ``impratio`` 1, in which an object held between two
    pads trembles by up to 0.1 mm; others make it worse.

    Raises ``ContactError`` if the law, or the file of one, cannot be read or gives no volume.

    Source: Winkler's foundation, K. L. Johnson 1985, Contact Mechanics, 4.3; MuJoCo's
    documentation, Computation, for the softness of contacts.
    """
    law = law if isinstance(law, ContactLaw) else load_law(law)
    if law.law != "volume_linear":
        msg = f"the law is {law.law}, which gives no volume; a pad of pins needs volume_linear"
        raise ContactError(msg)
    size_mm = gel_size_mm(sensor)
    columns, rows = (max(1, round(one / PINS.pitch_mm)) for one in size_mm)
    places = [
        (x, y, z)
        for y in (PINS.pitch_mm * (row + 0.5 - rows / 2) for row in range(rows))
        for x in (PINS.pitch_mm * (column + 0.5 - columns / 2) for column in range(columns))
        if math.isfinite(z := dome_mm(x * x + y * y, sensor.dome_radius_mm))
    ]
    k_n = law.k_n_mm3_per_n.value
    left_out = [f"the effect {effect.name} ({effect.channel})" for effect in law.effects]
    if not math.isnan(law.k_s_mm_per_n.value):
        left_out.append("k_s: pins do not give way sideways")
    pad = PinPad(
        pins=len(places),
        pitch_mm=PINS.pitch_mm,
        gel_size_mm=size_mm,
        pin_stiffness_n_per_mm=PINS.pitch_mm**2 / k_n,
        k_n_mm3_per_n=k_n,
        max_time_step_s=PINS.max_time_step_s,
        left_out=tuple(left_out),
    )
    with atomic_folder(out) as folder:
        write_text(folder / "pad.xml", _mjcf(pad, places, sensor))
    return pad


def _mjcf(pad: PinPad, places: list[tuple[float, float, float]], sensor: Sensor) -> str:
    stiffness = pad.pin_stiffness_n_per_mm / M_PER_MM
    armature, mass = stiffness / PINS.pin_rad_per_s**2, stiffness * PINS.mass_s2
    damping = 2 * PINS.damping_ratio * stiffness / PINS.pin_rad_per_s
    tip, reach = PINS.tip_mm * M_PER_MM, sensor.gel_depth_mm * M_PER_MM
    inertial = f'<inertial pos="0 0 0" mass="{mass:.4g}" diaginertia="{" ".join(["1e-12"] * 3)}"/>'
    pins = "\n".join(
        f'      <body pos="{" ".join(f"{M_PER_MM * one:.7g}" for one in place)}" gravcomp="1">'
        f'{inertial}<joint class="pin"/><geom class="pin"/></body>'
        for place in places
    )
    return f"""<mujoco model="pad of {sensor.name}">
  <!-- The gel of {sensor.name}, which gives way by V = k_n F, k_n = {pad.k_n_mm3_per_n:g} mm3/N.
       z points out of the gel; pins are {pad.pitch_mm:g} mm apart. The displaced volume is
       {pad.pitch_mm**2:g} mm2 times the sum of the joints' -q.
       Time step: at most {pad.max_time_step_s:g} s; cone: pyramidal, impratio 1. -->
  <default>
    <default class="pin">
      <joint type="slide" axis="0 0 1" stiffness="{stiffness:.8g}" damping="{damping:.4g}"
             armature="{armature:.4g}" limited="true" range="{-reach:.7g} {reach:.7g}"/>
      <geom type="sphere" size="{tip:.4g}" pos="0 0 {-tip:.4g}" contype="0" conaffinity="1"
            friction="0 0 0" solmix="1e9" solref="{PINS.contact_s:g} 1"
            solimp="{PINS.impedance} {PINS.impedance} 0.001"/>
    </default>
  </default>
  <worldbody>
    <body name="{PAD}">
{pins}
    </body>
  </worldbody>
</mujoco>
"""
