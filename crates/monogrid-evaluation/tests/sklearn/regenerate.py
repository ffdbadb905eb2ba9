#!/usr/bin/env python3
"""Writes random maps and what scikit-learn says about them.

    python3 -m venv /tmp/venv && /tmp/venv/bin/pip install scikit-learn==1.9.1
    /tmp/venv/bin/python tests/sklearn/regenerate.py

A map is a box of cells, x fastest: `truth` has one letter per cell (f free, o occupied, ? unknown),
`evidence` the estimate's log-odds in steps of 1/4096, null where not observed.
"""

import json
import pathlib

import numpy as np
import sklearn
from sklearn import metrics

HERE = pathlib.Path(__file__).parent
SIZE = (11, 9, 10)


def example(seed, tied):
    rng = np.random.default_rng(seed)
    count = int(np.prod(SIZE))
    truth = rng.choice(list("fo?"), size=count, p=[0.55, 0.15, 0.3])
    score = rng.normal(scale=1.2, size=count) + np.where(truth == "o", 0.9, -0.7)
    log_odds = np.clip(score, -2.0, 3.5)
    if tied:
        log_odds = np.clip(np.round(log_odds / 0.85) * 0.85, -2.0, 3.5)
    evidence = np.round(log_odds * 4096).astype(int)
    is_observed = rng.uniform(size=count) < 0.6
    return truth, evidence, is_observed


def judge(truth, evidence, is_observed):
    p = 1.0 / (1.0 + np.exp(-evidence / 4096.0))
    is_known = truth != "?"
    policies = {
        "observed": (is_known & is_observed, p),
        "known": (is_known, np.where(is_observed, p, 0.5)),
        "everything": (np.ones(len(p), bool), np.where(is_observed, p, 0.5)),
        "safety": (is_known, np.where(is_observed, p, 1.0)),
    }
    result = {}
    for name, (mask, scores) in policies.items():
        y, s = truth[mask] == "o", scores[mask]
        predicted = s > 0.5
        tn, fp, fn, tp = metrics.confusion_matrix(y, predicted).ravel()
        # The curve of the thesis: predicted occupied above each of 26 thresholds.
        thresholds = np.arange(26) / 25
        tpr = [np.mean(s[y] > t) for t in thresholds]
        fpr = [np.mean(s[~y] > t) for t in thresholds]
        result[name] = {
            "auc": metrics.roc_auc_score(y, s),
            "auc_26": metrics.auc([0.0, *fpr[::-1], 1.0], [0.0, *tpr[::-1], 1.0]),
            "mcc": metrics.matthews_corrcoef(y, predicted),
            "precision": metrics.precision_score(y, predicted),
            "recall": metrics.recall_score(y, predicted),
            "specificity": metrics.recall_score(~y, ~predicted),
            "f1": metrics.f1_score(y, predicted),
            "iou": metrics.jaccard_score(y, predicted),
            "tp": float(tp), "fp": float(fp), "tn": float(tn), "fn": float(fn),
        }
    mask = is_known & is_observed
    y, s = truth[mask] == "o", p[mask]
    scalars = {
        "brier": metrics.brier_score_loss(y, s),
        "negative_log_likelihood": metrics.log_loss(y, s),
    }
    value = np.select([truth == "o", truth == "f"], [1.0, 0.0], 0.5)
    square = ((np.where(is_observed, p, 0.5) - value) ** 2).reshape(SIZE[::-1])
    scalars["ssd"] = float(square.sum(axis=(1, 2)).mean())
    scalars["ssd_normalised"] = float(square.mean())
    return result, scalars


def main():
    examples = {}
    for name, seed, tied in [("spread", 1, False), ("tied", 2, True)]:
        truth, evidence, is_observed = example(seed, tied)
        policies, scalars = judge(truth, evidence, is_observed)
        examples[name] = {
            "size": SIZE,
            "truth": "".join(truth),
            "evidence": [int(e) if o else None for e, o in zip(evidence, is_observed)],
            "policies": policies,
            "scalars": scalars,
        }
    text = json.dumps({"scikit-learn": sklearn.__version__, "examples": examples})
    (HERE / "sklearn.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
