"""Largest differences of scores and poses between ONNX Runtime on GRAPH.onnx and what `csipose infer` wrote.

usage: onnxruntime_check.py GRAPH.onnx WINDOWS.npy FOLDER
"""
import sys

import numpy as np
import onnxruntime

graph, windows, folder = sys.argv[1:]
session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
answers = [session.run(["scores", "poses"], {"csi": window[None]}) for window in np.load(windows)]
differences = [np.abs(np.concatenate(got) - np.load(f"{folder}/{name}.npy")).max()
               for name, got in zip(("scores", "poses"), zip(*answers))]
print("scores %.2g poses_m %.2g" % tuple(differences))
