"""Speed and accuracy against peers, each in one run on one machine. `python -m benchmarks` lists and runs them."""
