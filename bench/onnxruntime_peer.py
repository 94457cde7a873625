"""Times ONNX Runtime's CPU build on a graph of `csipose model export`, or on a part of it.

usage: onnxruntime_peer.py GRAPH.onnx PRECISION THREADS RUNS WINDOW.f32 EXPECTED.f32
PRECISION int8: GRAPH was quantised dynamically. EXPECTED: what our engine has in the
graph's last output, for the largest difference.
"""
import sys

import numpy as np
import onnxruntime

import network_file

graph, precision, threads, runs, window, expected = sys.argv[1:]
options = onnxruntime.SessionOptions()
options.intra_op_num_threads = int(threads)
options.inter_op_num_threads = 1
options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
options.add_session_config_entry("session.set_denormal_as_zero", "1")
options.add_session_config_entry("session.intra_op.allow_spinning", "1")
session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
x = np.fromfile(window, np.float32).reshape(1, 60, 20, 9)
difference = float(np.abs(session.run(None, {"csi": x})[-1].ravel() - np.fromfile(expected, np.float32)).max())
figures = network_file.measure(lambda: session.run(None, {"csi": x}), int(runs))
part = "network" if session.get_outputs()[-1].name == "poses" else "encoder"
network_file.report(f"ONNX Runtime {onnxruntime.__version__} {part}", precision, int(threads), figures, difference)
