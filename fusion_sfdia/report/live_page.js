// The parts of the page are asked for again and again, and replaced where they have changed; the page itself stays.
{
  const shown = {};
  let answered = new Date();
  const busy = (element) => element.querySelector(".zoomed") || element.contains(document.activeElement);
  const refresh = async () => {
    const lost = document.getElementById("lost");
    try {
      const parts = await (await fetch("/parts", { signal: AbortSignal.timeout(30000) })).json();
      answered = new Date();
      for (const [id, html] of Object.entries(parts)) {
        const element = document.getElementById(id);
        if (shown[id] === html || (id === "figures" && busy(element))) continue;
        shown[id] = html;
        element.style.minHeight = `${element.offsetHeight}px`; // so that the page keeps its place while it is replaced
        element.innerHTML = html;
        enliven(element);
        element.style.minHeight = "";
      }
      const held = busy(document.getElementById("figures"));
      document.getElementById("held").textContent = held ? "Figures are paused while one is zoomed or focused: press Escape, then click beside them." : "";
      lost.textContent = "";
    } catch {
      lost.textContent = `No answer since ${answered.toLocaleTimeString()}: the watch has ended or cannot be reached. What is shown is out of date.`;
      return setTimeout(refresh, 5 * 1000 * document.body.dataset.poll);
    }
    setTimeout(refresh, 1000 * document.body.dataset.poll);
  };
  setTimeout(refresh, 1000 * document.body.dataset.poll);
}
