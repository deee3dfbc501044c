# SPDX-License-Identifier: Apache-2.0
"""What the scripts draw with, and how they fail; python_script.cc puts it in front of each."""
import sys


def fail(message):
    print(f"downpour: {message}", file=sys.stderr)
    sys.exit(2)


try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np
except ImportError as error:
    fail(f"{error.name} is missing: run tools/setup --pictures")

plt.rcParams.update({
    "font.size": 10, "axes.titlesize": 11, "axes.titleweight": "bold", "axes.titlelocation": "left",
    "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#6b7785",
    "axes.grid": True, "axes.axisbelow": True, "grid.color": "#e6e9ee", "legend.fontsize": 9,
    "legend.frameon": False, "svg.hashsalt": "downpour"})
