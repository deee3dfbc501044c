#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
#
# One share of a study's runs in each task of a Slurm job array:
#   sbatch docs/data/study/slurm_array.sh STUDY.toml
# The same again goes on with what is missing. When all tasks have ended, downpour study STUDY.toml
# makes the database.
#SBATCH --job-name=study
#SBATCH --array=1-8
#SBATCH --cpus-per-task=4
set -euo pipefail
exec downpour study "$1" --share "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"
