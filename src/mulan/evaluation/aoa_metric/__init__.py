"""The paper's two figures of its AoA metric, beside our sigma on the same trials."""
