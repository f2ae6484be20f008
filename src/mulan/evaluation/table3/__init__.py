"""The paper's active views in a closed loop: every rule from the same start, on the same candidates."""
