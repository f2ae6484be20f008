"""The bearing estimator on simulated links, against theory and the paper's metric."""
