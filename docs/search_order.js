// Answers whose title has more of the words that are searched come first, and of a title with a word the how-to.
const searched = (new URLSearchParams(location.search).get("q") || "").toLowerCase().match(/\w+/g) || [];
const inTitle = (title) => {
  const words = title.toLowerCase().match(/\w+/g) || [];
  return searched.filter((one) => words.some((word) => word.replace(/s$/, "") === one.replace(/s$/, ""))).length;
};
var Scorer = {
  objNameMatch: 11, objPartialMatch: 6, objPrio: {0: 15, 1: 5, 2: -5}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
  score: ([name, title, anchor, text, score]) =>
    score + 10 * inTitle(title) + (name.startsWith("howto/") && score >= 15 ? 20 : 0),
};
