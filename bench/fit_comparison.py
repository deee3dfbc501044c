#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Our optima of the likelihood beside those of scikit-learn, on the transitions of runs.

usage: bench/fit_comparison.py TASK RUN... [--episodes 8] [--restarts 1] [--program FILE]

Needs python3-sklearn. scikit-learn's GaussianProcessRegressor maximises the log likelihood of
ConstantKernel * RBF(ARD) + WhiteKernel from our first start and 5 random ones; ours subtracts a
curb (see engine/gp/gp_model.h) from it. So each output is compared twice: the log likelihood as it
is, where the curb may hold ours back, and less the curb, which scikit-learn then maximises, too.
All numbers are scikit-learn's log likelihood of either optimum. WORSE: ours is lower by more than
0.01 less the curb, or as it is though the curb is below 0.01 at scikit-learn's optimum. Exit
status 1 if some output is worse.
"""
import argparse
import json
import os
import subprocess
import sys
import time
import warnings

import numpy as np
from scipy.optimize import minimize
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

TOP = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
SLACK = 0.01


def curb(theta, log_std):
    """PILCO's curb of (log l, log sigma_f, log sigma_n), and its gradient."""
    x = np.append(theta[:-2] - log_std, theta[-2] - theta[-1])
    slope = 1 / np.log(np.append(np.full(len(log_std), 100), 500))
    gradient = 30 * (x * slope) ** 29 * slope
    return np.sum((x * slope) ** 30), np.append(gradient, -gradient[-1])


def sklearn_theta(theta):
    """scikit-learn's parameters: log sigma_f^2, log l, log sigma_n^2."""
    return np.concatenate(([2 * theta[-2]], theta[:-2], [2 * theta[-1]]))


def our_theta(theta):
    return np.concatenate((theta[1:-1], [theta[0] / 2, theta[-1] / 2]))


def our_theta_gradient(slope):
    """A slope with respect to ours as one with respect to scikit-learn's."""
    return np.concatenate(([slope[-2] / 2], slope[:-2], [slope[-1] / 2]))


def fit(inputs, target, with_curb):
    std, rms = inputs.std(axis=0, ddof=1), np.sqrt(np.mean(target**2))

    def maximise(objective, theta, bounds):
        def penalised(theta):
            value, gradient = objective(theta, eval_gradient=True)
            penalty, slope = curb(our_theta(theta), np.log(std))
            return value + penalty, gradient + our_theta_gradient(slope)

        result = minimize(penalised, theta, method="L-BFGS-B", jac=True, bounds=bounds)
        return result.x, result.fun

    kernel = ConstantKernel(rms**2, (1e-5, 1e5)) * RBF(std, (1e-5, 1e5)) + WhiteKernel(
        rms**2 / 100, (1e-14, 1e5)
    )
    gp = GaussianProcessRegressor(
        kernel,
        alpha=0,  # not a trace of noise besides the kernel's: noise-free data show it
        optimizer=maximise if with_curb else "fmin_l_bfgs_b",
        n_restarts_optimizer=5,
        random_state=0,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return gp.fit(inputs, target)


def main():
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("task")
    parser.add_argument("run", nargs="+")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--restarts", type=int, default=1, help="ours")
    parser.add_argument("--program", default=os.path.join(TOP, "build/release/bin/fit_bench"))
    options = parser.parse_args()
    command = [options.program, options.task, *options.run, "--data"]
    command += ["--episodes", str(options.episodes), "--restarts", str(options.restarts)]
    ours = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    inputs, targets = np.array(ours["inputs"]), np.array(ours["targets"])
    log_std = np.log(inputs.std(axis=0, ddof=1))

    print(f"{options.task}, n = {len(inputs)}; a cold fit of all outputs: "
          f"{ours['cold_fit_seconds']:.3f} s (ours)")
    print(f"{'':16}{'log likelihood':>35}{'less the curb':>26}{'sklearn':>10}")
    print(f"{'output':16}{'ours':>11}{'sklearn':>11}{'its curb':>13}{'ours':>15}{'sklearn':>11}"
          f"{'s':>10}")
    worse = False
    for output, target in zip(ours["outputs"], targets.T):
        start = time.monotonic()
        plain, curbed = fit(inputs, target, False), fit(inputs, target, True)
        seconds = (time.monotonic() - start) / 2
        mine = np.log(output["lengthscales"] + [output["signal_std"], output["noise_std"]])
        value = plain.log_marginal_likelihood(sklearn_theta(mine))
        penalised = value - curb(mine, log_std)[0]
        their_value = plain.log_marginal_likelihood_value_
        their_curb = curb(our_theta(plain.kernel_.theta), log_std)[0]
        their_theta = curbed.kernel_.theta
        their_penalised = (
            curbed.log_marginal_likelihood(their_theta) - curb(our_theta(their_theta), log_std)[0]
        )
        is_worse = penalised < their_penalised - SLACK or (
            their_curb < SLACK and value < their_value - SLACK
        )
        worse |= is_worse
        print(f"{output['name']:16}{value:11.3f}{their_value:11.3f}{their_curb:13.3g}"
              f"{penalised:15.3f}{their_penalised:11.3f}{seconds:10.1f}"
              f"  {'WORSE' if is_worse else 'no worse'}")
    sys.exit(1 if worse else 0)


if __name__ == "__main__":
    main()
