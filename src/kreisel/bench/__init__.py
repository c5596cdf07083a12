"""Speed on this machine: what `kreisel bench` shows in short, and the scripts of benchmarks/ in full."""
