"""Results of the rigid contact search, as arrays of one shape; see `railenv.contact.geometry`."""

from dataclasses import dataclass

from railenv.units import FloatArray


@dataclass(frozen=True)
class TouchPoints:
    """Points of rigid touch; all arrays have the shape of the poses.

    Attributes:
        height: Height of touch of the wheelset's centre, positive down [m].
        shift_slope: dh/du, minus the tangent of the contact angle [1].
        roll_slope: dh/dphi [m/rad].
        yaw_slope: dh/dpsi [m/rad].
        forward: x of the point in wheelset axes that do not spin [m].
        lateral: y of the point along the axle from the wheelset's centre [m].
        on_wheel: y of the point in the wheel profile's axes, from the tape circle [m].
        radius: Rolling radius, its distance from the axle [m].
        on_rail: y of the point in the track, from the track's centre [m].
        angle: Contact angle against the track's plane, positive towards the flange [rad].
        wheel_curvature: Mean curvature of the wheel's profile there, convex positive [1/m].
        rail_curvature: Likewise of the rail [1/m].
        rolling_curvature: Curvature of the wheel along the track [1/m].
        weight: Share of the zone in this patch, 0 to 1 [1]; 1 when no zone was asked for.
    """

    height: FloatArray
    shift_slope: FloatArray
    roll_slope: FloatArray
    yaw_slope: FloatArray
    forward: FloatArray
    lateral: FloatArray
    on_wheel: FloatArray
    radius: FloatArray
    on_rail: FloatArray
    angle: FloatArray
    wheel_curvature: FloatArray
    rail_curvature: FloatArray
    rolling_curvature: FloatArray
    weight: FloatArray


@dataclass(frozen=True)
class WheelsetContact:
    """A wheelset with both wheels on rigid rails; all arrays have the shape of the shifts.

    Attributes:
        shift: Lateral displacement of the wheelset's centre [m].
        yaw: Yaw angle [rad].
        roll: Roll angle that lets both wheels touch [rad].
        height: Displacement of the wheelset's centre, positive down, zero when centred [m].
        right: The right wheel's point.
        left: The left wheel's point, written as a right wheel's in the mirror image.
    """

    shift: FloatArray
    yaw: FloatArray
    roll: FloatArray
    height: FloatArray
    right: TouchPoints
    left: TouchPoints
