"""The paper's first table: two robots, noisy poses, and what each setup makes of them."""
