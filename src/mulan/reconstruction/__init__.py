"""Learning the field from posed photographs: weights, training, checkpoints, held-out figures."""
