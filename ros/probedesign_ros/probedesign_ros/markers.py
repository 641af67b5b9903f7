"""Markers of a contact: its covariance ellipsoid, and an arrow that ends at the touched point."""

import numpy as np
from geometry_msgs.msg import Point, Quaternion
from visualization_msgs.msg import Marker, MarkerArray

CHI_95 = 2.7955  # square root of the 95 % quantile of χ² with three degrees of freedom, 7.8147
MIN_DIAMETER = 1.8e-3  # m, so that a small ellipsoid remains visible
ARROW_LENGTH = 0.03  # m
THICKNESS = 5e-4  # m, of a plane, so that it is visible
LIFETIME_S = 1  # after which a contact without a newer one disappears


def ellipsoid(cov):
    """Return half-axes (3,) [m] of the 95 % ellipsoid and its axes (3, 3), right-handed, of a covariance [m²]."""
    variances, axes = np.linalg.eigh(cov)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    return CHI_95 * np.sqrt(np.maximum(variances, 0.0)), axes


def quaternion_of(R):
    """Return x, y, z, w of a rotation matrix (3, 3).

    The eigenvector to the largest eigenvalue of Bar-Itzhack's matrix, which is well defined for every rotation.
    """
    (a, b, c), (d, e, f), (g, h, i) = R
    K = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    return np.linalg.eigh(K)[1][:, -1]


def contact_markers(header, position, cov, force):
    """Return the markers of a contact; `force` is None where it is not known in this frame."""
    half_axes, axes = ellipsoid(cov)
    sphere = _marker(header, "ellipsoid", Marker.SPHERE)
    sphere.pose.position = Point(x=position[0], y=position[1], z=position[2])
    x, y, z, w = map(float, quaternion_of(axes))
    sphere.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    sphere.scale.x, sphere.scale.y, sphere.scale.z = (float(max(2.0 * a, MIN_DIAMETER)) for a in half_axes)
    markers = [sphere]
    norm = 0.0 if force is None else float(np.linalg.norm(force))
    if np.isfinite(norm) and norm > 0.0:
        arrow = _marker(header, "force", Marker.ARROW)
        start = (np.asarray(position) - ARROW_LENGTH * np.asarray(force) / norm).tolist()
        arrow.points = [Point(x=p[0], y=p[1], z=p[2]) for p in (start, position)]
        arrow.scale.x, arrow.scale.y, arrow.scale.z = 1.2e-3, 3.2e-3, 5e-3
        markers.append(arrow)
    return MarkerArray(markers=markers)


def shape_markers(header, document):
    """Return the shapes of `explore` and an arrow to the next touch, after a marker that removes the earlier ones."""
    markers = [_marker(header, "shapes", 0)]
    markers[0].action = Marker.DELETEALL
    for number, shape in enumerate(document["shapes"]):
        axes, extent = np.array(shape["axes"]).T, 1e-3 * np.array(shape["extent_mm"]).reshape(-1, 2)
        centre, size = 1e-3 * np.array(shape["p_mm"]), extent[:, 1] - extent[:, 0]
        middle, round_to = extent.mean(axis=1), 2e-3 * (shape["radius_mm"] or 1.0)
        if shape["kind"] == "plane":
            kind, centre, scale = Marker.CUBE, centre + axes[:, :2] @ middle, (size[0], size[1], THICKNESS)
        elif shape["kind"] in ("edge", "cylinder"):
            kind, centre, scale = Marker.CYLINDER, centre + axes[:, 2] * middle[0], (round_to, round_to, size[0])
        else:
            kind, scale = Marker.SPHERE, (round_to, round_to, round_to)
        marker = _marker(header, "shapes", kind)
        marker.id, marker.lifetime.sec = number, 0
        marker.pose.position = Point(x=float(centre[0]), y=float(centre[1]), z=float(centre[2]))
        x, y, z, w = map(float, quaternion_of(axes))
        marker.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
        marker.scale.x, marker.scale.y, marker.scale.z = (float(max(part, THICKNESS)) for part in scale)
        marker.color.r, marker.color.g, marker.color.b = 0.04, 0.48, 0.29
        markers.append(marker)
    best = document.get("suggestion")
    if best is not None:
        x = 1e-3 * np.array(best["p_world_mm"])
        start = x + ARROW_LENGTH * np.array(best["normal_world"])
        arrow = _marker(header, "next touch", Marker.ARROW)
        arrow.points = [Point(x=p[0], y=p[1], z=p[2]) for p in (start.tolist(), x.tolist())]
        arrow.scale.x, arrow.scale.y, arrow.scale.z, arrow.lifetime.sec = 1.2e-3, 3.2e-3, 5e-3, 0
        markers.append(arrow)
    return MarkerArray(markers=markers)


def no_contact(header):
    """Return the markers that remove those of the last contact."""
    markers = [_marker(header, name, 0) for name in ("ellipsoid", "force")]
    for marker in markers:
        marker.action = Marker.DELETE
    return MarkerArray(markers=markers)


def _marker(header, name, kind):
    marker = Marker(header=header, ns=name, id=0, type=kind)
    marker.color.r, marker.color.g, marker.color.b, marker.color.a = 0.91, 0.28, 0.26, 0.8
    marker.lifetime.sec = LIFETIME_S
    return marker
