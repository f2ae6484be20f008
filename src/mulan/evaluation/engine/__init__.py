"""The engine's benchmark: quality against training time, throughput, memory, and peers on the same data."""
