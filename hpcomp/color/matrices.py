"""The matrices of the primaries and whites that have names, as numbers, and how 3×3 are multiplied.

So a run among them imports no colour science; `primaries` does, for what is not here. All are what
SMPTE RP 177 and Bradford's adaptation (Lam 1985) make of the chromaticities of `PRIMARIES`, in the
16 digits of colour-science; a test holds each against the library.
"""

from __future__ import annotations

from collections.abc import Sequence

#: Three rows of three numbers, hashable.
Matrix = tuple[tuple[float, ...], ...]

#: Linear RGB to CIE XYZ by the names of primaries: white is D65 at Y = 1, adapted where it is not.
#: Those of Rec. 709 are in `primaries`.
RGB_TO_XYZ: dict[str, Matrix] = {
    "display-p3": (
        (0.486570948648216, 0.2656676931690931, 0.1982172852343625),
        (0.2289745640697487, 0.6917385218365064, 0.079286914093745),
        (0.0, 0.04511338185890264, 1.0439443689009757),
    ),
    "rec2020": (
        (0.6369580483012912, 0.1446169035862084, 0.16888097516417208),
        (0.262700212011267, 0.6779980715188711, 0.05930171646986195),
        (0.0, 0.028072693049087445, 1.0609850577107909),
    ),
    "acescg": (
        (0.6522375418862888, 0.12823613599971256, 0.16998224916567045),
        (0.2676721801253368, 0.6743399888015505, 0.057987831073112416),
        (-0.005381815766387654, 0.0013690602090958457, 1.09307050631717),
    ),
    "aces2065-1": (
        (0.938279849277257, -0.004451445812360876, 0.01662752358677557),
        (0.3373688907878375, 0.7295215666902649, -0.06689045747810247),
        (0.0011739508496858557, -0.003710706402052516, 1.0915945063122445),
    ),
    "adobe-rgb": (
        (0.5766690429101304, 0.1855582379065463, 0.1882286462349947),
        (0.29734497525053605, 0.6273635662554661, 0.07529145849399788),
        (0.02703136138641234, 0.07068885253582723, 0.9913375368376387),
    ),
}

#: XYZ under D65 at (0.3127, 0.3290) to XYZ under the D50 of ICC profiles, (0.9642, 1, 0.8249).
D65_TO_D50: Matrix = (
    (1.0478860032225505, 0.02291876517477955, -0.050216095311733044),
    (0.029581782498003462, 0.9904835184905485, -0.017078707704482696),
    (-0.009251880839208845, 0.015072607487031322, 0.7516781336176034),
)


def product(a: Sequence[Sequence[float]], b: Sequence[Sequence[float]]) -> Matrix:
    """a · b, in plain numbers: the same on every machine."""
    return tuple(
        tuple(
            sum(x * y for x, y in zip(row, column, strict=True)) for column in zip(*b, strict=True)
        )
        for row in a
    )


def inverted(m: Sequence[Sequence[float]]) -> Matrix:
    """The inverse of a 3×3 matrix, in plain numbers: the same on every machine."""

    def minor(row: int, column: int) -> float:
        r, s = (row + 1) % 3, (row + 2) % 3
        c, d = (column + 1) % 3, (column + 2) % 3
        return m[r][c] * m[s][d] - m[r][d] * m[s][c]

    whole = sum(m[0][column] * minor(0, column) for column in range(3))
    return tuple(tuple(minor(row, column) / whole for row in range(3)) for column in range(3))
