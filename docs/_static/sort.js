// Tables in elements of class "sortable": a click on a heading sorts the rows by that column.
document.addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll(".sortable table")) {
    const body = table.tBodies[0];
    [...table.tHead.rows[0].cells].forEach((heading, column) => {
      const button = document.createElement("button");
      button.append(...heading.childNodes);
      heading.append(button);
      button.addEventListener("click", () => {
        const down = heading.getAttribute("aria-sort") === "ascending" ? -1 : 1;
        for (const other of heading.parentNode.cells) other.removeAttribute("aria-sort");
        heading.setAttribute("aria-sort", down > 0 ? "ascending" : "descending");
        const text = (row) => row.cells[column].textContent.trim().replaceAll("−", "-");
        const number = (row) => parseFloat(text(row).replace(/^(≈|in part) /, ""));
        body.append(...[...body.rows].sort((one, two) => {
          const [a, b] = [number(one), number(two)];
          return isNaN(a) - isNaN(b) || down * (a - b || text(one).localeCompare(text(two)));
        }));
      });
    });
  }
});
