"""Somebody is followed by a Kalman filter, which takes each frame's floor plan for a measurement of the place.

A backprojection of what changes is brightest where somebody is. Its plan B gives a place with the likelihood
exp(a B / σ), of which mean and covariance are the measurement of a linear Kalman filter: a frame in which nothing
stands out says next to nothing, because its likelihood covers the room. The state is place and velocity along right
and depth, with white acceleration; a Rauch-Tung-Striebel smoother goes back over all frames.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_laplace

from datagen.baselines.walks import Walks
from datagen.errors import InputError
from datagen.records.arrays import Floats

SHARPNESS = (1.0, 2.0, 4.0, 8.0)
"""Candidates for a; the one is taken with which the walks of the split train are found best."""
STEP_M = 0.1
"""Standard deviation of a measurement that is as sharp as can be, metres: half a person."""
ACCELERATION_M_S2 = 2.0
"""Standard deviation of a walker's acceleration: at a corner of its way it turns within half a second."""


def kalman_ways(train: Walks, wanted: Walks) -> tuple[Floats, Floats]:
    """Places and velocities (N, F, 2) along right and depth of the label frame, metres and metres a second.

    Raises `InputError` if the library filterpy is not installed.
    """
    maps = brightness_of(train)
    off = [
        np.median(np.linalg.norm(_smooth_ways(train, maps, train, sharp)[0] - train.centers[..., [0, 2]], axis=-1))
        for sharp in SHARPNESS
    ]
    return _smooth_ways(wanted, brightness_of(wanted), train, SHARPNESS[int(np.argmin(off))])


def brightness_of(walks: Walks) -> Floats:
    """(N, F, depth, column) how much a place stands out: minus the Laplacian of a Gaussian of one voxel, in standard
    deviations of a frame's plan."""
    plans = walks.plans.astype(np.float64).sum(axis=2)
    found = np.array([[-gaussian_laplace(plan, 1.0) for plan in of_walk] for of_walk in plans])
    found /= found.std(axis=(2, 3), keepdims=True)
    return found


def place_and_spread(brightness: Floats, low: Floats, high: Floats, sharpness: float) -> tuple[Floats, Floats]:
    """Mean (F, 2) and covariance (F, 2, 2) of the place by the likelihood exp(`sharpness` · `brightness`).

    brightness : (F, depth, column) over a plan between corners low and high (2,) along right and depth, metres.
    """
    frames, layers, columns = brightness.shape
    right, depth = ((np.arange(n) + 0.5) / n for n in (columns, layers))
    places = low + np.stack(np.meshgrid(right, depth), axis=-1).reshape(-1, 2) * (high - low)
    flat = sharpness * brightness.reshape(frames, -1)
    weight = np.exp(flat - flat.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    mean = weight @ places
    apart = places - mean[:, None]
    return mean, np.einsum("fk,fki,fkj->fij", weight, apart, apart) + STEP_M**2 * np.eye(2)


def _smooth_ways(walks: Walks, maps: Floats, train: Walks, sharpness: float) -> tuple[Floats, Floats]:
    """Places and velocities (N, F, 2) of walks with maps (N, F, depth, column), whose first place is one that the
    walkers of `train` may have."""
    shares = train.shares.reshape(-1, 2)
    first, spread = walks.metres(shares.mean(axis=0)[None, None])[:, 0], shares.std(axis=0) * (walks.high - walks.low)
    speed = float(train.velocities[..., [0, 2]].std())
    states = [
        _smooth_track(*place_and_spread(brightness, low, high, sharpness), place, wide, speed, walks.step_s)
        for brightness, low, high, place, wide in zip(maps, walks.low, walks.high, first, spread, strict=True)
    ]
    found = np.array(states)
    return found[..., [0, 2]], found[..., [1, 3]]


def _smooth_track(
    places: Floats, covariances: Floats, first: Floats, spread: Floats, speed: float, step_s: float
) -> Floats:  # fmt: skip
    """(F, 4) right, its velocity, depth and its velocity, from measured places (F, 2) with covariances (F, 2, 2).

    first, spread : (2,) mean and standard deviation of the first place. speed : standard deviation of a velocity.
    """
    try:
        from filterpy.common import Q_discrete_white_noise
        from filterpy.kalman import KalmanFilter
    except ImportError:
        raise InputError(
            "METHOD = 'tracking': the Kalman filter is filterpy's, which is not installed; "
            "pip install 'nlos-datagen[tracking]'"
        ) from None
    kalman = KalmanFilter(dim_x=4, dim_z=2)
    kalman.x = np.array([first[0], 0.0, first[1], 0.0])
    kalman.P = np.diag([spread[0] ** 2, speed**2, spread[1] ** 2, speed**2])
    kalman.F = np.kron(np.eye(2), [[1.0, step_s], [0.0, 1.0]])
    kalman.H = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    kalman.Q = np.kron(np.eye(2), Q_discrete_white_noise(2, step_s, ACCELERATION_M_S2**2))
    means, errors = [], []
    for number, (place, covariance) in enumerate(zip(places, covariances, strict=True)):
        if number:
            kalman.predict()
        kalman.update(place, R=covariance)
        means.append(kalman.x.copy())
        errors.append(kalman.P.copy())
    return np.asarray(kalman.rts_smoother(np.array(means), np.array(errors))[0])
