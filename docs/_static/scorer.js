// Copyright 2026 The manip_sim developers
// SPDX-License-Identifier: Apache-2.0

// How the search ranks its results: a title that has all words of the query comes before titles and
// texts that have one of them, and guides come before the Python API. The other numbers are the
// defaults of Sphinx.
var Scorer = {
  score: ([docname, title, anchor, descr, score, filename, kind]) =>
    (kind === 'title' ? 3 : 1) * (docname.startsWith('reference/api/') ? 0.5 : 1) * score,
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
