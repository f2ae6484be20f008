"""nerfstudio's tensorf in plain torch on the CPU.

PEER_PYTHON benchmarks/peers/tensorf.py --data LEGO --image-size 100 --budget-s 300 --out tensorf.json
"""

from nerfstudio_method import run

if __name__ == "__main__":
    run("tensorf")
