#!/usr/bin/env python3
"""What the tables of companding cameras do to normal noise: sums over whole codes, beside steps of one size.

Root mean squares over tables and levels, in powers of the step, by the noise in steps (r) and the step in codes (Q): mean, variance
beside Q^2 / 12, fourth cumulant, and how much the variances of pixels differ whose levels scatter by a code. The bounds in
sim/src/effects/companding.rs come from here.
"""
import math

import numpy as np

FULL = 4095.0


def root_table(level, step):
    codes = 2 * math.sqrt(level * FULL) / step
    return lambda d: np.round(FULL * (np.round(codes * np.sqrt(np.maximum(d, 0) / FULL)) / codes) ** 2)


def knee_table(level, step):
    return lambda d: np.where(d > 70, np.round(70 + np.round((d - 70) / step) * step), d)


def moments(table, level, sd):
    codes = np.arange(math.floor(level - 6 * sd) - 1, math.ceil(level + 6 * sd) + 2)
    edge = [0.5 * math.erf((c - 0.5 - level) / sd / math.sqrt(2)) for c in [*codes, codes[-1] + 1]]
    share, out = np.diff(edge), table(codes)
    mean = (share * out).sum()
    variance, fourth = ((share * (out - mean) ** k).sum() for k in (2, 4))
    return mean - level, variance, fourth - 3 * variance**2


def main():
    rng = np.random.default_rng(1)
    print("table  r     Q    mean    variance  fourth   variances differ")
    for name, table in (("root", root_table), ("knee", knee_table)):
        for r in (0.15, 0.25, 0.4, 0.55, 0.7, 1.0, 1.5, 2.5, 4.0):
            for step in (1.3, 2.2, 3.0, 3.4, 4.4, 5.5, 9.0):
                rows = []
                for level in rng.uniform(80, 3000, 60):
                    of = table(level, step)
                    pixels = np.array([moments(of, level + x, r * step) for x in rng.normal(0, 1, 24)])
                    mean, variance, fourth = pixels.mean(axis=0)
                    square = step**2
                    excess = variance - (r * step) ** 2 - square / 12
                    rows.append((mean / step, excess / square, fourth / square**2, pixels[:, 1].var() / square**2))
                mean, variance, fourth, apart = np.sqrt(np.mean(np.square(rows), axis=0))
                print(f"{name}  {r:4.2f}  {step:3.1f}  {mean:.4f}  {variance:.4f}    {fourth:.4f}   {apart:.5f}")


if __name__ == "__main__":
    main()
