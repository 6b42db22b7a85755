"""A beam with nothing bent, for tests."""

from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from tests.one_joint import Linear


def straight(system: Linear) -> CamBeam:
    """The linear system as the rig's own, which is compiled anyway: on no crank, without friction."""
    return CamBeam(
        gain=system.gain,
        centre=system.centre,
        stiffness=system.stiffness,
        damping=system.damping,
        input_delay=system.input_delay,
        coulomb=0.0,
        stribeck_excess=0.0,
        asymmetry=0.0,
        quadratic_stiffness=0.0,
        cam_curvature=0.0,
    )
