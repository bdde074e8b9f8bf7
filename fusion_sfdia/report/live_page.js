// The parts of the page are asked for again and again, and replaced where they have changed; the page itself stays.
{
  const shown = {};
  const busy = (element) => element.querySelector(".zoomed") || element.contains(document.activeElement);
  const refresh = async () => {
    const lost = document.getElementById("lost");
    try {
      const parts = await (await fetch("/parts")).json();
      for (const [id, html] of Object.entries(parts)) {
        const element = document.getElementById(id);
        if (shown[id] === html || busy(element)) continue;
        shown[id] = html;
        element.style.minHeight = `${element.offsetHeight}px`; // so that the page keeps its place while it is replaced
        element.innerHTML = html;
        enliven(element);
        element.style.minHeight = "";
      }
      lost.textContent = "";
    } catch {
      lost.textContent = `No answer since ${new Date().toLocaleTimeString()}: the watch has ended, or cannot be reached. What is shown is old.`;
      return setTimeout(refresh, 5 * 1000 * document.body.dataset.poll);
    }
    setTimeout(refresh, 1000 * document.body.dataset.poll);
  };
  setTimeout(refresh, 1000 * document.body.dataset.poll);
}
