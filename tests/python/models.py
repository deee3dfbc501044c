# SPDX-License-Identifier: Apache-2.0
"""Data and models that the tests of the Python package share."""
import functools

import downpour as dp
import numpy as np


def smooth_data(n=60, dim=3, outputs=2, seed=0):
    """Noisy smooth functions: X (n, dim), Y (n, outputs), and hyper-parameters that suit them."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2, 2, size=(n, dim))
    w = rng.normal(size=(dim, outputs))
    y = np.sin(x @ w) + 0.05 * rng.normal(size=(n, outputs))
    lengthscales = rng.uniform(1, 2, size=(outputs, dim))
    return x, y, (lengthscales, np.full(outputs, 1.2), np.full(outputs, 0.05))


@functools.cache
def cartpole_data(episodes=3):
    """Model inputs (n, 6) and targets (n, 4) of episodes with random actions."""
    env = dp.make("cartpole")
    rng = np.random.default_rng(0)
    inputs, targets = [], []
    for episode in range(episodes):
        observation, done = env.reset(seed=episode), False
        while not done:
            u = rng.uniform(-env.action_limit, env.action_limit)
            after, _, done, _ = env.step(u)
            inputs.append(np.concatenate([env.features(observation), u]))
            targets.append(after - observation)
            observation = after
    return np.array(inputs), np.array(targets)


@functools.cache
def cartpole_model(tolerance=0.02, backend="auto"):
    x, y = cartpole_data()
    return dp.GaussianProcess.fit(x, y, tolerance=tolerance, backend=backend)


def network(theta, features, t):
    """Cart-pole's default network in NumPy."""
    theta, x = theta.T, features.T / np.array([[5.0], [5], [10], [1], [1]])
    hidden = np.tanh(np.einsum("hfl,fl->hl", theta[:50].reshape(10, 5, -1), x) + theta[50:60])
    return 10 * np.tanh(np.einsum("hl,hl->l", theta[60:70], hidden) + theta[70])[:, None]


def cartpole_reward(states, actions, t):
    d2 = states[:, 1]**2 + (np.cos(states[:, 3]) + 1)**2 + np.sin(states[:, 3])**2
    return np.exp(-d2 / (2 * 0.25**2))


def thetas(count, seed=0, parameters=71):
    return np.random.default_rng(seed).normal(size=(count, parameters))
