// What a search of the site shows first: pages whose title has all the words, then those that are read
// from the start; records of what was measured or changed last. Numbers are those of Sphinx, but for `score`.
var Scorer = {
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
  score: ([page, title, anchor, , score]) => {
    const asked = new URLSearchParams(window.location.search).get("q") || "";
    const words = asked.toLowerCase().split(/[^\p{L}\p{N}]+/u).filter(Boolean);
    const named = title.toLowerCase();
    let found = score;
    if (!anchor && words.every((word) => named.includes(word))) found += 20;
    if (/^(start|howto|mathematics|frames|rkmk|implicit|lifting)/.test(page)) found += 6;
    if (/^(changes|benchmarks|searches|reliability|contributing)/.test(page)) found -= 20;
    return found;
  },
};
