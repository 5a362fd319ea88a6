"""The figures of version 0.1 in `benchmarks.consistency`, to compare with: first seed 1000.

    python -m benchmarks.consistency --record --drives 20 --case "laser alone" --case ...
    python -m benchmarks.consistency --record --drives 10 --case ...

Rows of 20 drives come from the first command, rows of 10 from the second. Where the error comes from one draw per
drive (the heading at the first scan), the mean ANEES of ten drives is rough: half or twice the figure is chance.
"""

from __future__ import annotations

from math import nan

from .consistency_figures import Means

# drives; ANEES, worst; position; aligned, worst [mm]; inside 3 sigma; walls (nan: the start is exact)
BEFORE = {
    "laser alone": Means(20, 2.303, 11.38, 60.93, 10.15, 15.59, 0.8585, 0.3096),
    "laser alone, smoothed": Means(20, 3.504, 15.06, 53.63, 2.208, 2.5, 0.7454, 0.9685),
    "laser, start 2°, 0.05 m": Means(20, 9.698, 48.91, 193.7, 17.45, 29.03, 0.6395, 0.1495),
    "laser, start 5°, 0.1 m": Means(20, 40.75, 149.3, 391.0, 29.54, 50.54, 0.4165, 0.05312),
    "laser, start 20°, 0.5 m": Means(20, 1027.0, 5458.0, 1489.0, 43.0, 86.63, 0.1054, 0.009229),
    "laser, start 90°, 0.5 m": Means(20, 16650.0, 76070.0, 4376.0, 40.39, 86.45, 0.05239, 0.002059),
    "laser, start 180°, 0.5 m": Means(10, 10770.0, 33490.0, 4070.0, 38.39, 86.44, 0.04561, 0.00103),
    "laser at 40 Hz": Means(10, 8.929, 59.2, 72.0, 10.17, 25.46, 0.6539, 0.1378),
    "laser from 6 s": Means(10, 7.291, 31.22, 125.9, 13.09, 18.59, 0.6984, 0.09646),
    "laser silent 30-50 s": Means(10, 2.915, 7.816, 106.9, 61.0, 115.7, 0.8286, 0.2267),
    "compass+lrf, offset estimated": Means(10, 1.208, 3.02, 36.34, 7.943, 11.53, 0.9753, 0.3771),
    "compass+lrf, offset estimated, smoothed": Means(10, 1.267, 3.297, 28.35, 2.189, 2.363, 0.9821, 0.977),
    "compass+lrf, offset given": Means(10, 0.9597, 2.325, 8.529, 4.461, 5.158, 0.9982, 0.07653),
    "compass+lrf, offset given, smoothed": Means(10, 0.8289, 2.363, 5.927, 2.186, 2.359, 0.9994, 0.7119),
    "compass+lrf, start 5°, 0.1 m": Means(10, 3.208, 7.166, 169.6, 41.99, 71.77, 0.8805, 0.07152),
    "compass+lrf, start 20°, 0.5 m": Means(10, 41.8, 122.0, 735.5, 94.09, 148.0, 0.6694, 0.06699),
    "compass from 20 s, start 20°, 0.5 m": Means(10, 1113.0, 3544.0, 1623.0, 65.68, 138.2, 0.1297, 0.002811),
    "landmark bearing, start 20°, 0.5 m": Means(10, 59.53, 311.8, 373.0, 187.0, 477.7, 0.4224, 0.02493),
    "GPS 1 m, start 20°, 0.5 m": Means(10, 778.5, 2392.0, 1076.0, 254.0, 545.8, 0.1587, 0.005599),
    "GPS 5 cm, start 20°, 0.5 m": Means(10, 526.8, 1547.0, 631.7, 52.87, 74.95, 0.1545, 0.003049),
    "placed anew at 30 s": Means(10, 2.296, 5.811, 67.71, 10.2, 13.77, 0.8483, 0.3336),
    "placed anew at 30 s, start 20°, 0.5 m": Means(10, 1045.0, 3517.0, 1621.0, 45.23, 97.22, 0.1287, 0.009834),
    "fixed 6 mm pattern": Means(10, 0.849, 2.072, 4.12, 3.08, 4.279, 0.9921, nan),
    "fixed 6 mm pattern, 60 s of rest": Means(10, 12.14, 33.74, 1.836, 1.61, 1.905, 0.8274, nan),
    "laser 3 cm off": Means(10, 13.01, 15.72, 27.04, 11.85, 13.09, 0.7446, 0.0764),
    "laser 2° off": Means(10, 2298.0, 5480.0, 591.7, 99.17, 131.6, 0.1357, 0.0633),
    "laser's clock 20 ms off": Means(10, 1.399, 2.141, 9.018, 5.184, 5.63, 0.9929, 0.07962),
    "round room": Means(10, 26.16, 112.9, 84.87, 33.24, 55.51, 0.4642, 0.2022),
}
