"""Elementary functions that give the same bits on every processor.

The sine of numpy and of the C library comes in variants per processor (AVX-512, FMA) that
differ in the last bit, and what is computed from it is written into artifacts whose names
are digests. Here only additions, multiplications, divisions and square roots are used, which
IEEE 754 rounds in one way everywhere. The series are Taylor's; after range reduction they
are cut off where the next term is below half a unit in the last place. Errors stay within a
few units in the last place. All functions work elementwise on arrays of any shape.
"""

from itertools import accumulate
from math import pi

import numpy as np

from bagassets.geometry.se3 import Floats

# (-1)^k / (2k + 1)!  and  (-1)^k / (2k)!
_SINC = list(accumulate(range(1, 12), lambda last, k: -last / ((2 * k) * (2 * k + 1)), initial=1.0))
_COS = list(accumulate(range(1, 12), lambda last, k: -last / ((2 * k - 1) * (2 * k)), initial=1.0))
_ARCTAN = [(-1.0 if k % 2 else 1.0) / (2 * k + 1) for k in range(9)]


def _horner(coefficients: list[float], x: Floats) -> Floats:
    total = np.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def sinc(angles_rad: Floats) -> Floats:
    """Return sin(x) / x, 1 at zero, for |x| <= pi/2."""
    return _horner(_SINC, angles_rad * angles_rad)


def arctan_unit(ratios: Floats) -> Floats:
    """Return arctan(x) in radians for 0 <= x <= 1."""
    x = ratios
    for _ in range(3):  # arctan(x) = 2 arctan(x / (1 + sqrt(1 + x²))): from 45° down to 5.6°
        x = x / (1.0 + np.sqrt(1.0 + x * x))
    return 8.0 * x * _horner(_ARCTAN, x * x)


def arctan2(y: Floats, x: Floats) -> Floats:
    """Return the angle of (x, y) in radians, between -pi and pi; 0 for the origin."""
    y, x = np.asarray(y, dtype=np.float64), np.asarray(x, dtype=np.float64)
    long, short = np.maximum(np.abs(x), np.abs(y)), np.minimum(np.abs(x), np.abs(y))
    steep = arctan_unit(short / np.where(long == 0, 1.0, long))
    first_quadrant = np.where(np.abs(y) > np.abs(x), pi / 2 - steep, steep)
    upper = np.where(x < 0, pi - first_quadrant, first_quadrant)
    return np.where(y < 0, -upper, upper)


def arctanh_small(ratios: Floats) -> Floats:
    """Return artanh(x) for |x| <= 0.12."""
    return ratios * _horner(_ARCTAN, -ratios * ratios)


def sinh_cosh_small(x: Floats) -> tuple[Floats, Floats]:
    """Return hyperbolic sine and cosine of |x| <= pi/2."""
    return x * _horner(_SINC, -x * x), _horner(_COS, -x * x)


def sin_cos_deg(angles_deg: Floats) -> tuple[Floats, Floats]:
    """Return sine and cosine of angles in degrees; multiples of 90 degrees are exact."""
    angles = np.asarray(angles_deg, dtype=np.float64)
    quarters = np.floor(angles / 90.0 + 0.5)
    rest = (angles - 90.0 * quarters) * (pi / 180.0)  # the difference is exact
    return _of_quarter(quarters, rest)


def sin_cos(angles_rad: Floats) -> tuple[Floats, Floats]:
    """Return sine and cosine of angles in radians, meant for a few turns at most."""
    angles = np.asarray(angles_rad, dtype=np.float64)
    quarters = np.floor(angles / (pi / 2) + 0.5)
    # pi/2 in two parts (Cody and Waite); the first has 33 bits, so that its multiples are exact.
    rest = (angles - quarters * 1.5707963267341256) - quarters * 6.077100506506192e-11
    return _of_quarter(quarters, rest)


def _of_quarter(quarters: Floats, rest_rad: Floats) -> tuple[Floats, Floats]:
    """Sine and cosine of `quarters` right angles plus a rest within ±45 degrees."""
    s = rest_rad * sinc(rest_rad)
    c = _horner(_COS, rest_rad * rest_rad)
    turn = np.mod(quarters, 4.0)
    sine = np.where(turn == 0, s, np.where(turn == 1, c, np.where(turn == 2, -s, -c)))
    cosine = np.where(turn == 0, c, np.where(turn == 1, -s, np.where(turn == 2, -c, s)))
    return sine, cosine
