"""An impact as nine numbers: problem, solution and methods; knows nothing of robots."""
