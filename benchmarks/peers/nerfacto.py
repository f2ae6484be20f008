"""nerfstudio's nerfacto in plain torch on the CPU.

PEER_PYTHON benchmarks/peers/nerfacto.py --data LEGO --image-size 100 --budget-s 300 --out nerfacto.json
"""

from nerfstudio_method import run

if __name__ == "__main__":
    run("nerfacto")
